<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.16" styleCategories="Symbology">
 <renderer-v2 type="graduatedSymbol" attr="rmse_px" graduatedMethod="GraduatedColor" symbollevels="0" enableorderby="0">
  <ranges>
   <range lower="0" upper="0.02" symbol="0" label="≤ 0.02 px" render="true"/>
   <range lower="0.02" upper="0.05" symbol="1" label="0.02 – 0.05 px" render="true"/>
   <range lower="0.05" upper="0.1" symbol="2" label="0.05 – 0.1 px" render="true"/>
   <range lower="0.1" upper="0.2" symbol="3" label="0.1 – 0.2 px" render="true"/>
   <range lower="0.2" upper="0.5" symbol="4" label="0.2 – 0.5 px" render="true"/>
   <range lower="0.5" upper="1000000000" symbol="5" label="&gt; 0.5 px" render="true"/>
  </ranges>
  <symbols>
   <symbol type="marker" name="0" alpha="1" clip_to_extent="1" force_rhr="0">
    <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
     <Option type="Map">
      <Option type="QString" name="name" value="circle"/>
      <Option type="QString" name="color" value="68,1,84,255"/>
      <Option type="QString" name="outline_color" value="255,255,255,255"/>
      <Option type="QString" name="outline_width" value="0.2"/>
      <Option type="QString" name="size" value="2.4"/>
     </Option>
    </layer>
   </symbol>
   <symbol type="marker" name="1" alpha="1" clip_to_extent="1" force_rhr="0">
    <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
     <Option type="Map">
      <Option type="QString" name="name" value="circle"/>
      <Option type="QString" name="color" value="65,68,135,255"/>
      <Option type="QString" name="outline_color" value="255,255,255,255"/>
      <Option type="QString" name="outline_width" value="0.2"/>
      <Option type="QString" name="size" value="2.4"/>
     </Option>
    </layer>
   </symbol>
   <symbol type="marker" name="2" alpha="1" clip_to_extent="1" force_rhr="0">
    <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
     <Option type="Map">
      <Option type="QString" name="name" value="circle"/>
      <Option type="QString" name="color" value="42,120,142,255"/>
      <Option type="QString" name="outline_color" value="255,255,255,255"/>
      <Option type="QString" name="outline_width" value="0.2"/>
      <Option type="QString" name="size" value="2.4"/>
     </Option>
    </layer>
   </symbol>
   <symbol type="marker" name="3" alpha="1" clip_to_extent="1" force_rhr="0">
    <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
     <Option type="Map">
      <Option type="QString" name="name" value="circle"/>
      <Option type="QString" name="color" value="34,168,132,255"/>
      <Option type="QString" name="outline_color" value="255,255,255,255"/>
      <Option type="QString" name="outline_width" value="0.2"/>
      <Option type="QString" name="size" value="2.4"/>
     </Option>
    </layer>
   </symbol>
   <symbol type="marker" name="4" alpha="1" clip_to_extent="1" force_rhr="0">
    <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
     <Option type="Map">
      <Option type="QString" name="name" value="circle"/>
      <Option type="QString" name="color" value="122,209,81,255"/>
      <Option type="QString" name="outline_color" value="255,255,255,255"/>
      <Option type="QString" name="outline_width" value="0.2"/>
      <Option type="QString" name="size" value="2.4"/>
     </Option>
    </layer>
   </symbol>
   <symbol type="marker" name="5" alpha="1" clip_to_extent="1" force_rhr="0">
    <layer class="SimpleMarker" enabled="1" locked="0" pass="0">
     <Option type="Map">
      <Option type="QString" name="name" value="circle"/>
      <Option type="QString" name="color" value="253,231,37,255"/>
      <Option type="QString" name="outline_color" value="255,255,255,255"/>
      <Option type="QString" name="outline_width" value="0.2"/>
      <Option type="QString" name="size" value="2.4"/>
     </Option>
    </layer>
   </symbol>
  </symbols>
  <classificationMethod id="Custom"/>
 </renderer-v2>
</qgis>
