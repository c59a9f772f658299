<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.16" styleCategories="Symbology">
 <pipe>
  <rasterrenderer type="singlebandpseudocolor" band="4" opacity="1" alphaBand="-1" classificationMin="0" classificationMax="4" nodataColor="">
   <rastershader>
    <colorrampshader colorRampType="DISCRETE" classificationMode="1" clip="0" minimumValue="0" maximumValue="4">
     <item value="0" color="#808080" alpha="60" label="0"/>
     <item value="1" color="#d55e00" alpha="255" label="1"/>
     <item value="2" color="#0072b2" alpha="255" label="2"/>
     <item value="3" color="#009e73" alpha="255" label="3"/>
     <item value="4" color="#cc79a7" alpha="255" label="4"/>
     <item value="inf" color="#e69f00" alpha="255" label="≥ 5"/>
    </colorrampshader>
   </rastershader>
  </rasterrenderer>
  <rasterresampler maxOversampling="2" zoomedOutResampler="0" zoomedInResampler="0"/>
 </pipe>
</qgis>
